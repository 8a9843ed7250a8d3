"""The pages of `check` and `init`: a small panel for each recording."""
