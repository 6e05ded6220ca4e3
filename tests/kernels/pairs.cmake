prt_test(pair_kernels SOURCES kernels/pairs.c LIBS prt_screen LABELS kernels)
target_include_directories(test_pair_kernels PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
