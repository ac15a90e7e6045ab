"""Collision in time: when bodies that move within one step first touch."""
