prt_test(radial SOURCES ${CMAKE_CURRENT_LIST_DIR}/radial.c LIBS prt_medium prt_base LABELS physics TIMEOUT 600)
