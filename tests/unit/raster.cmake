prt_test(raster SOURCES unit/raster.c LIBS prt_raster LABELS unit)
