"""Certified distance: an interval that holds the distance of two bodies, and the verdict on them."""
