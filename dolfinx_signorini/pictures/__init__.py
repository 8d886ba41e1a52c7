"""Pictures of solutions, meshes and contact, in the plane and in space."""
