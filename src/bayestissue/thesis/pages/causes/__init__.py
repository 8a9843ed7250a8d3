"""The page that says why K grows with the mass."""
