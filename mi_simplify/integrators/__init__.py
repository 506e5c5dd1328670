"""The direct_edge integrator: shading, edges and boundary samples."""
