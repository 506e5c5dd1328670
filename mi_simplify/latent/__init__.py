"""What is optimised: mesh and textures, and the paper's differentiable mesh operations."""
