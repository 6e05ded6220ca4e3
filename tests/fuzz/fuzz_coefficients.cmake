include(${CMAKE_CURRENT_LIST_DIR}/_target.cmake)
prt_fuzz(fuzz_coefficients SOURCES fuzz/fuzz_coefficients.c ROOMS librelight relight_proto SECONDS 3
  SEEDS ${CMAKE_CURRENT_LIST_DIR}/seeds/coefficients)
target_include_directories(fuzz_coefficients PRIVATE ${CMAKE_SOURCE_DIR}/client/lib
  ${CMAKE_SOURCE_DIR}/client/include ${CMAKE_SOURCE_DIR}/proto ${CMAKE_BINARY_DIR}/proto)
