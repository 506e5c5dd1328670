"""Charts and their atlas."""
