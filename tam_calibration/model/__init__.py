"""What is measured with, and what comes of it: array, sensors, recording and field."""
