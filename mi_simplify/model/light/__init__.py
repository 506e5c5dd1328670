"""Light that belongs to a model: its environment, its ambient term, what it gives off."""
