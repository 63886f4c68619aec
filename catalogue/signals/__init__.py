"""From a recording to what can be compared: sensors, steady part, mains lines, noise floor, levels."""
