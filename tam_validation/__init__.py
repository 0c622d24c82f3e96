"""Whether the package is right: the check on withheld effects, and the figures of the papers. No node imports it."""
