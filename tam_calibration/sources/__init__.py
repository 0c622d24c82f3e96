"""The sources of a field that is to be found: dipole and loop, and what an array reads of an alternating one."""
