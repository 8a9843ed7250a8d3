"""The page of `reproduce`."""
