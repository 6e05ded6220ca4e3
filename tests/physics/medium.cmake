prt_test(medium SOURCES ${CMAKE_CURRENT_LIST_DIR}/medium.c LIBS prt_medium prt_base LABELS physics)
