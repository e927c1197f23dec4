"""Files for other programs: OBJ, GLB, 16-bit PNG, float TIFF."""
