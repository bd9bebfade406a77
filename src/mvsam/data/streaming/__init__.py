"""An endless stream of training samples: mixed sources, augmentation, frames kept at their size."""
