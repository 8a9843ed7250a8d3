"""Beside the recorder: its folder is followed, each drop judged, the dataset and the study grow."""
