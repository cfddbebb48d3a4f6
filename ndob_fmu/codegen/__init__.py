"""From a model to the source code of its equations and steps."""
