"""Built-in arms: a folder of data each."""
