"""The built-in models, one short file each; users' own files look the same."""
