"""Images with their cameras and lights: transforms.json."""
