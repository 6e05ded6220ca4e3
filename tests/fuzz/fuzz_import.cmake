include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_import SOURCES fuzz/fuzz_import.c ROOMS prt_medium prt_base
  SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/import ${CMAKE_SOURCE_DIR}/../shared/data/materials/mtlx)
