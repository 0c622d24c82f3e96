"""A simulator's recording beside a real one: what differs, and the mend."""
