"""Models in and out, one folder a format, its reader beside its writer."""
