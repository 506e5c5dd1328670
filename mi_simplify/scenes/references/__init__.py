"""What renders the images that a fit aims at."""
