prt_test(walk SOURCES ${CMAKE_CURRENT_LIST_DIR}/walk.c physics/bodies.c LIBS prt_reference LABELS physics)
