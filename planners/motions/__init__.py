"""From configurations to one timed motion: searches, smoothing and timing laws."""
