"""HTML reports for people, and the figures that they share; the rows of their tables need no plots."""
