prt_test(specular SOURCES physics/specular.c LIBS prt_raster prt_light LABELS physics)
target_include_directories(test_specular PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
