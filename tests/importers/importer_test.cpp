// Dispatch, and what a file may refer to.

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "importers/file_resolver.h"
#include "tests/importers/bvh_writer.h"
#include "tests/importers/support.h"

namespace limber::test {
namespace {

namespace fs = std::filesystem;

class ImportFiles : public testing::Test {
 protected:
  void SetUp() override {
    const auto* info = testing::UnitTest::GetInstance()->current_test_info();
    root_ = fs::temp_directory_path() /
            ("limber_importer_" + std::to_string(::getpid()) + "_" + info->name());
    fs::create_directories(root_ / "in" / "sub");
    write(root_ / "secret.bin", "secret");
    write(root_ / "in" / "near.bin", "near");
    write(root_ / "in" / "sub" / "a b.bin", "deep");
  }
  void TearDown() override { fs::remove_all(root_); }

  static void write(const fs::path& path, const std::string& text) {
    std::ofstream(path, std::ios::binary) << text;
  }
  std::string resolve(const std::string& uri) const {
    const auto bytes = folder_resolver(root_ / "in")(uri);
    if (!bytes) return bytes.error().code;
    return {reinterpret_cast<const char*>(bytes->data()), bytes->size()};
  }
  std::string code(const fs::path& path) const {
    const auto imported = import_file(path);
    if (imported) return "ok";
    EXPECT_EQ(imported.error().file, path.string());
    return imported.error().code;
  }

  fs::path root_;
};

TEST_F(ImportFiles, UrisStayInsideTheFolder) {
  EXPECT_EQ(resolve("near.bin"), "near");
  EXPECT_EQ(resolve("./near.bin"), "near");
  EXPECT_EQ(resolve("sub/a%20b.bin"), "deep");
  EXPECT_EQ(resolve("data:application/octet-stream;base64,bmVhcg=="), "near");
  EXPECT_EQ(resolve("data:,n%65ar"), "near");
  for (const char* uri :
       {"../secret.bin", "sub/../../secret.bin", "%2e%2e/secret.bin", "/etc/passwd",
        "%2Fetc/passwd", "file:///etc/passwd", "http://example.com/a.bin", "..",
        "sub\\..\\..\\secret.bin", "", "near.bin%00", "%zz", "data:base64", "data:;base64,a"}) {
    EXPECT_EQ(resolve(uri), "uri-refused") << uri;
  }
  EXPECT_EQ(resolve("missing.bin"), "uri-missing");
}

TEST_F(ImportFiles, LinksThatLeadOutAreRefused) {
  fs::create_symlink(root_ / "secret.bin", root_ / "in" / "absolute.bin");
  fs::create_symlink("../secret.bin", root_ / "in" / "relative.bin");
  fs::create_symlink(root_, root_ / "in" / "folder");
  fs::create_symlink("near.bin", root_ / "in" / "inside.bin");
  EXPECT_EQ(resolve("absolute.bin"), "uri-refused");
  EXPECT_EQ(resolve("relative.bin"), "uri-refused");
  EXPECT_EQ(resolve("folder/secret.bin"), "uri-refused");
  EXPECT_EQ(resolve("inside.bin"), "near");
}

TEST_F(ImportFiles, OnlyRegularFilesAreRead) {
  ASSERT_EQ(::mkfifo((root_ / "in" / "pipe.bvh").c_str(), 0600), 0);
  EXPECT_EQ(resolve("pipe.bvh"), "file-unreadable");  // and does not hang
  EXPECT_EQ(resolve("sub"), "file-unreadable");
  EXPECT_EQ(code(root_ / "in" / "pipe.bvh"), "file-unreadable");
  fs::create_directory(root_ / "folder.bvh");
  EXPECT_EQ(code(root_ / "folder.bvh"), "file-unreadable");
}

TEST_F(ImportFiles, EveryRefusalHasItsCode) {
  EXPECT_EQ(code(root_ / "none.bvh"), "file-missing");
  write(root_ / "empty.bvh", "");
  EXPECT_EQ(code(root_ / "empty.bvh"), "file-empty");
  write(root_ / "clip.txt", "HIERARCHY");
  EXPECT_EQ(code(root_ / "clip.txt"), "format-unknown");
  EXPECT_EQ(code(root_ / "secret.bin"), "format-unknown");
  if (::geteuid() != 0) {
    write(root_ / "locked.bvh", "HIERARCHY");
    fs::permissions(root_ / "locked.bvh", fs::perms::none);
    EXPECT_EQ(code(root_ / "locked.bvh"), "file-unreadable");
  }
}

TEST(Importer, MisnamedContentIsNamed) {
  const auto message = [](std::string_view text, std::string_view extension) {
    const auto imported = import_text(text, extension);
    EXPECT_FALSE(imported);
    if (imported) return std::string();
    EXPECT_EQ(imported.error().code, "format-mismatch");
    return imported.error().message;
  };
  using namespace std::string_view_literals;
  EXPECT_NE(message("version https://git-lfs.github.com/spec/v1\noid sha256:0", "glb").find("LFS"),
            std::string::npos);
  EXPECT_NE(message("\n<!DOCTYPE html><p>404", "bvh").find("web page"), std::string::npos);
  EXPECT_NE(message("\x1F\x8B\x08\0\0"sv, "fbx").find("gzip"), std::string::npos);
  EXPECT_NE(message("PK\x03\x04", "vrm").find("zip"), std::string::npos);
  EXPECT_NE(message("HIERARCHY\nROOT a", "glb").find("bvh"), std::string::npos);
  EXPECT_NE(message("Kaydara FBX Binary  \0"sv, "bvh").find("fbx"), std::string::npos);
}

TEST(Importer, ExtensionsInAnyCaseAndWithDot) {
  const std::string text = BvhWriter({}).write();
  for (const char* extension : {"bvh", "BVH", ".bvh", ".Bvh"}) {
    EXPECT_TRUE(import_text(text, extension)) << extension;
  }
}

TEST(Importer, Utf16TextIsReadWithAWarning) {
  const std::string text = BvhWriter({}).write();
  std::string wide = "\xFF\xFE";
  for (const char c : text) wide += {c, '\0'};
  const auto imported = import_text(wide, "bvh");
  ASSERT_TRUE(imported) << imported.error().message;
  EXPECT_TRUE(has_warning(*imported, "text-encoding"));
  EXPECT_EQ(imported->clips[0].frames(), 20);
}

TEST(Importer, OwnReadersByDefault) {
  const auto imported = import_text(BvhWriter({}).write(), "bvh");
  ASSERT_TRUE(imported);
  EXPECT_EQ(imported->facts.reader, "limber-bvh");
  EXPECT_FALSE(imported->facts.reader_reason.empty());
}

}  // namespace
}  // namespace limber::test
