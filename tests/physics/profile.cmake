prt_test(profile SOURCES ${CMAKE_CURRENT_LIST_DIR}/profile.c LIBS prt_medium prt_base LABELS physics)
target_include_directories(test_profile PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
