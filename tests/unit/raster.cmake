prt_test(raster SOURCES unit/raster.c LIBS prt_raster LABELS unit)
target_include_directories(test_raster PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
