"""What all rooms stand on: errors, words, settings, files of a result, the runtime."""
