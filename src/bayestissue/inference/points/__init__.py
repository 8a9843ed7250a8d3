"""Point estimates of single traces."""
