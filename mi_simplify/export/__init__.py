"""Files out: glTF, OBJ, USD."""
