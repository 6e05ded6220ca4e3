prt_test(phases SOURCES ${CMAKE_CURRENT_LIST_DIR}/phases.c physics/bodies.c LIBS prt_bake LABELS physics)
target_include_directories(test_phases PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
