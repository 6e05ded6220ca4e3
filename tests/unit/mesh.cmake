prt_test(mesh SOURCES unit/mesh.c LIBS prt_mesh LABELS unit)
