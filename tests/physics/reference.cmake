prt_test(reference SOURCES ${CMAKE_CURRENT_LIST_DIR}/reference.c physics/bodies.c LIBS prt_reference LABELS physics)
