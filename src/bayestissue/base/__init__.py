"""What all rooms stand on: outcomes, errors and warnings with their words, settings, files, the runtime."""
