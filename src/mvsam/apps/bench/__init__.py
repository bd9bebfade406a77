"""Speed and memory on this machine: ours beside the textbook forms, box by box of Figure 3."""
