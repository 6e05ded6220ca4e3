prt_test(part_inputs SOURCES ${CMAKE_CURRENT_LIST_DIR}/part_inputs.c physics/bodies.c LIBS prt_bake LABELS physics)
target_include_directories(test_part_inputs PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
