"""The first guess: clean up, decimate, unwrap, bake."""
