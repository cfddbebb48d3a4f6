"""A recorded log of a plant: reading it, the observer along it, the smoother over it, and what they say of settings."""
