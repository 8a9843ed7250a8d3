"""What people ask of a finished fit: K and C at any levels, questions, predictions."""
