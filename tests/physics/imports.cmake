prt_test(imports SOURCES ${CMAKE_CURRENT_LIST_DIR}/imports.c physics/bodies.c LIBS prt_reference LABELS physics)
