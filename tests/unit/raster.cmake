prt_test(raster SOURCES unit/raster.c LIBS prt_raster z LABELS unit)
