"""Arrays of pixels to the bytes of image files, and back where nobody else reads them."""
