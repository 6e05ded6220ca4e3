prt_test(radial SOURCES ${CMAKE_CURRENT_LIST_DIR}/radial.c LIBS prt_medium prt_base LABELS physics)
target_include_directories(test_radial PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
