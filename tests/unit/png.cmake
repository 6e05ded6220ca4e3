prt_test(png SOURCES unit/png.c LIBS prt_raster z LABELS unit)
