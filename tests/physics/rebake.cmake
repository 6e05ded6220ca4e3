prt_test(rebake SOURCES ${CMAKE_CURRENT_LIST_DIR}/rebake.c physics/bodies.c LIBS prt_bake LABELS physics TIMEOUT 600)
target_include_directories(test_rebake PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
