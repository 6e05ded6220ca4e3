prt_test(factors SOURCES unit/factors.c LIBS librelight relight_proto LABELS unit)
target_include_directories(test_factors PRIVATE ${CMAKE_SOURCE_DIR}/client/lib ${CMAKE_SOURCE_DIR}/libprt/include)
