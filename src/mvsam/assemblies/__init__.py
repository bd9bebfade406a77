"""Models put together from parts, as the paper's rows ask for them; `build.py` gives them names."""
