# Libraries of the light room: OpenEXRCore, libturbojpeg, libdeflate or zlib, Zstandard; the OpenImageIO shim.
# Not by find_package: Debian's OpenEXR, Imath and OpenImageIO configurations name programs and
# Python modules that are in packages nobody needs here.
pkg_check_modules(OPENEXR REQUIRED OpenEXR)
find_library(OPENEXRCORE_LIBRARY NAMES OpenEXRCore OpenEXRCore-3_1 OpenEXRCore-3_2
  HINTS ${OPENEXR_LIBRARY_DIRS} REQUIRED)
pkg_check_modules(TURBOJPEG REQUIRED IMPORTED_TARGET libturbojpeg)
pkg_check_modules(LIBDEFLATE IMPORTED_TARGET libdeflate)
pkg_check_modules(LIBZSTD REQUIRED IMPORTED_TARGET libzstd)
target_include_directories(prt_light SYSTEM PRIVATE ${OPENEXR_INCLUDE_DIRS})
target_link_libraries(prt_light PUBLIC ${OPENEXRCORE_LIBRARY} PkgConfig::TURBOJPEG PkgConfig::LIBZSTD
  ${CMAKE_DL_LIBS})
if(LIBDEFLATE_FOUND)
  target_link_libraries(prt_light PUBLIC PkgConfig::LIBDEFLATE)
  target_compile_definitions(prt_light PRIVATE PRT_HAVE_LIBDEFLATE)
else()
  find_package(ZLIB REQUIRED)
  target_link_libraries(prt_light PUBLIC ZLIB::ZLIB)
endif()

# Loaded by dlopen in the decoding child only: 262 libraries come with it.
pkg_check_modules(OPENIMAGEIO REQUIRED IMPORTED_TARGET OpenImageIO)
add_library(prt_oiio MODULE ${CMAKE_CURRENT_SOURCE_DIR}/light/shim_oiio.cpp)
set_target_properties(prt_oiio PROPERTIES PREFIX lib CXX_VISIBILITY_PRESET hidden
  LIBRARY_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/bin)
target_include_directories(prt_oiio PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/light)
target_include_directories(prt_oiio SYSTEM PRIVATE ${OPENIMAGEIO_INCLUDE_DIRS}
  ${OPENEXR_INCLUDE_DIRS})
target_link_libraries(prt_oiio PRIVATE prt_options PkgConfig::OPENIMAGEIO
  ${OPENEXR_LINK_LIBRARIES})
install(TARGETS prt_oiio LIBRARY DESTINATION lib/relight)
add_dependencies(prt_light prt_oiio)
