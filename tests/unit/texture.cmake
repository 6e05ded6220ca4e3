prt_test(texture SOURCES unit/texture.c LIBS prt_trace prt_raster prt_mesh prt_texture prt_light LABELS unit)
target_include_directories(test_texture PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
