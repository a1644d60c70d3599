"""Datasets for learning: episodes marked while recording, and recordings written as LeRobotDataset v3.0."""
