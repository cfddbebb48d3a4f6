"""Components and their connections."""
