"""What is looked at, and from where."""
