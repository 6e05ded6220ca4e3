prt_test(exit SOURCES ${CMAKE_CURRENT_LIST_DIR}/exit.c physics/bodies.c LIBS prt_bake prt_screen LABELS physics)
