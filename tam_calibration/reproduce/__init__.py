"""The simulations of the papers run again: what each prints, what comes out, and which of the two is wrong."""
