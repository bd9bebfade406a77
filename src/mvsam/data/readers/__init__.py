"""One file a format: each reader turns a folder into a `Scene`."""
