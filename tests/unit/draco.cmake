prt_test(draco SOURCES unit/draco.c unit/draco_file.cpp LIBS prt_mesh LABELS unit)
