"""What Sphinx needs to know of this manual beyond its own extensions."""
