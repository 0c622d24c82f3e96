"""The law of a gap: what a disturbance does to a reading, in which sensors and axes, and its course in time."""
