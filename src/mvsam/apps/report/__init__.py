"""One self-contained HTML page about a folder of `mvsam predict`: scores, cloud, every photo."""
