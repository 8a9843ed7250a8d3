"""Beside the recorder: its folder followed, each drop judged, the dataset and the study so far as they grow."""
