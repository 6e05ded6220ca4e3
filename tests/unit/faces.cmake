prt_test(faces SOURCES unit/faces.c LIBS prt_light zstd LABELS unit)
