"""Models whose parts belong to nodes: taken apart, and put together again."""
