include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_mtl SOURCES fuzz/fuzz_mtl.c LIBS prt_mesh SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/mtl)
target_include_directories(fuzz_mtl PRIVATE ${CMAKE_SOURCE_DIR}/libprt)
