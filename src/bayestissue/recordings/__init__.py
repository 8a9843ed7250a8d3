"""What a lab recorded: files, datasets, signal processing, and `init`, which makes the one of the other."""
