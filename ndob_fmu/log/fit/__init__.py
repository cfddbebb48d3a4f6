"""Noise, class and pace of the disturbance, and parameters of the plant, from a recorded log."""
