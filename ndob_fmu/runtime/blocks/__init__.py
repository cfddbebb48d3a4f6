"""The plant and the other components of a system."""
