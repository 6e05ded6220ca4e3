pkg_check_modules(CJSON REQUIRED IMPORTED_TARGET libcjson)
find_library(MESHOPTIMIZER_LIBRARY meshoptimizer REQUIRED)
find_library(DRACO_LIBRARY draco REQUIRED)
target_link_libraries(prt_mesh PRIVATE PkgConfig::CJSON ${MESHOPTIMIZER_LIBRARY} ${DRACO_LIBRARY})
