#include "pipeline/batch_record.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <utility>

namespace limber {
namespace {

using json = nlohmann::ordered_json;

Error cannot_write(const std::filesystem::path& path, int error) {
  return {.code = "output-unwritable",
          .message = std::strerror(error),
          .file = path.string(),
          .hint = "check space and permissions of the output folder"};
}

json stamps_json(const std::vector<FileStamp>& stamps, bool with_time) {
  json out = json::array();
  for (const FileStamp& s : stamps) {
    json entry{{"path", s.path}, {"bytes", s.bytes}};
    if (with_time) entry["mtime_ns"] = s.mtime_ns;
    entry["hash"] = s.hash;
    out.push_back(std::move(entry));
  }
  return out;
}

std::vector<FileStamp> stamps_from(const json& list) {
  std::vector<FileStamp> out;
  for (const json& entry : list) {
    out.push_back({.path = entry.at("path"),
                   .bytes = entry.at("bytes"),
                   .mtime_ns = entry.value("mtime_ns", std::int64_t(0)),
                   .hash = entry.at("hash")});
  }
  return out;
}

}  // namespace

std::string to_json_line(const BatchRecord& record) {
  const json out{{"item", record.item},
                 {"recipe", record.recipe},
                 {"staged", record.staged},
                 {"inputs", stamps_json(record.inputs, true)},
                 {"files", stamps_json(record.files, false)},
                 {"removes", record.removes},
                 {"clips", json::parse(to_json(record.clips))},
                 {"attempts", record.attempts},
                 {"seconds", record.seconds}};
  return out.dump(-1, ' ', false, json::error_handler_t::replace) + "\n";
}

std::optional<BatchRecord> record_from_json(std::string_view line) {
  try {
    const json document = json::parse(line);
    BatchRecord record{.item = document.at("item"),
                       .recipe = document.at("recipe"),
                       .staged = document.at("staged"),
                       .inputs = stamps_from(document.at("inputs")),
                       .files = stamps_from(document.at("files")),
                       .removes = document.at("removes"),
                       .clips = summaries_from_json(document.at("clips").dump()),
                       .attempts = document.at("attempts"),
                       .seconds = document.at("seconds")};
    if (record.clips.empty()) return std::nullopt;
    return record;
  } catch (const json::exception&) {
    return std::nullopt;
  }
}

Journal::~Journal() {
  if (fd_ >= 0) ::close(fd_);
}

Journal::Journal(Journal&& other) noexcept
    : path_(std::move(other.path_)), fd_(std::exchange(other.fd_, -1)) {}

Journal& Journal::operator=(Journal&& other) noexcept {
  std::swap(path_, other.path_);
  std::swap(fd_, other.fd_);
  return *this;
}

Result<Journal> Journal::open(const std::filesystem::path& path) {
  Journal journal;
  journal.path_ = path;
  journal.fd_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
  struct stat info {};
  if (journal.fd_ < 0 || ::fstat(journal.fd_, &info) != 0) return cannot_write(path, errno);
  char last = '\n';
  if (info.st_size > 0 && ::pread(journal.fd_, &last, 1, info.st_size - 1) == 1 && last != '\n') {
    // A writer was killed within its line: the next one must not continue it.
    if (::write(journal.fd_, "\n", 1) != 1) return cannot_write(path, errno);
  }
  return journal;
}

Result<void> Journal::append(const BatchRecord& record) {
  const std::string line = to_json_line(record);
  const off_t before = ::lseek(fd_, 0, SEEK_END);
  const auto fail = [&] {
    const int error = errno;
    if (before >= 0 && ::ftruncate(fd_, before) == 0) ::fsync(fd_);
    return cannot_write(path_, error);
  };
  std::size_t put = 0;
  while (put < line.size()) {
    const ssize_t n = ::write(fd_, line.data() + put, line.size() - put);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return fail();
    put += static_cast<std::size_t>(n);
  }
  if (::fsync(fd_) != 0) return fail();
  return {};
}

void read_journal(const std::filesystem::path& path, const std::function<void(BatchRecord)>& take) {
  std::ifstream in(path, std::ios::binary);
  for (std::string line; std::getline(in, line);) {
    if (auto record = record_from_json(line)) take(std::move(*record));
  }
}

}  // namespace limber
