"""The first guess: reduce, unwrap, bake; or cards, a sphere, an isosurface, a mesh of the user's own."""
