"""Rhino 3DM archives."""
