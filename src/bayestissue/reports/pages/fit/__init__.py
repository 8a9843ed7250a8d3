"""The page of a fit of recorded traces."""
