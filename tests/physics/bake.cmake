prt_test(bake SOURCES ${CMAKE_CURRENT_LIST_DIR}/bake.c physics/bodies.c LIBS prt_bake LABELS physics TIMEOUT 900)
