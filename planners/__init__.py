"""Motion planning: problem in, plan out; and the processes it runs in."""
