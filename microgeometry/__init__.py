"""The specimen: surfaces, height maps, meshes and what they are made of. Knows no ray."""
