"""What stands on top of prediction and reconstruction."""
