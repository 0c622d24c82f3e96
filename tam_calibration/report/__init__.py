"""HTML reports for people, and the figures that they share; their paragraphs and tables need no plots."""
