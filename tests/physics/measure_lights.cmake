prt_test(measure_lights SOURCES physics/measure_lights.c LIBS prt_bake LABELS physics)
target_include_directories(test_measure_lights PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
