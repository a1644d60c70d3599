"""From a goal to configurations in which it holds: placo."""
