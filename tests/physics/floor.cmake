prt_test(floor SOURCES ${CMAKE_CURRENT_LIST_DIR}/floor.c physics/bodies.c LIBS prt_screen LABELS physics)
