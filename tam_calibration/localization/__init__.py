"""Localisation: from a recording, or its field and gradient, to the source: where it is, and how strong."""
