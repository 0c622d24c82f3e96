"""Physical effects: what each adds to the readings, and how to take it off."""
