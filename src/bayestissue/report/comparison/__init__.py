"""The page of a comparison: how well finished fits predict, and what they estimate."""
