"""Tissue that is pushed by what is no free mass: its motion and its force are both measured."""
