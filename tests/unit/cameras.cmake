prt_test(cameras SOURCES unit/cameras.c LIBS prt_raster LABELS unit)
