"""From the field and its gradient to the source: where it is, and how strong."""
