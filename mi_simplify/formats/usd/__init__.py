"""USD layers and packages."""
