prt_test(profile SOURCES ${CMAKE_CURRENT_LIST_DIR}/profile.c LIBS prt_medium prt_base LABELS physics)
