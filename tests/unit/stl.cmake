prt_test(stl SOURCES unit/stl.c LIBS prt_mesh LABELS unit)
