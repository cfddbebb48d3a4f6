"""Inputs that are wrong on purpose, thousands of them by a seed; each module is a command that prints a count.

Run from the project's folder, for instance: python -m tests.attacks.states --trials 5000 --seed 1 --fmus build/fmus
"""
