"""What is optimised, and the step that each of it takes."""
