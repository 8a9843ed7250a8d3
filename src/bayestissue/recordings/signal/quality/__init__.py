"""What is wrong with a recording, beyond what its file shows: detectors with known rates of false alarms."""

from bayestissue.recordings.signal.quality.inspection import Findings, inspect, raised

__all__ = ["Findings", "inspect", "raised"]
