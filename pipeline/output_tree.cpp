#include "pipeline/output_tree.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <random>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

namespace limber {
namespace {

namespace fs = std::filesystem;

Error cannot_write(const fs::path& path, const std::error_code& error) {
  return {.code = "output-unwritable",
          .message = error.message(),
          .file = path.string(),
          .hint = "check space and permissions of the output folder"};
}

std::error_code last_error() { return {errno, std::generic_category()}; }

/// Opens a file and locks it; children inherit the lock, so that it outlasts a killed parent until
/// the last of them is gone.
Result<int> lock_file(const fs::path& path, bool shared) {
  const int fd = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666);
  if (fd < 0) return cannot_write(path, last_error());
  constexpr int kTries = 60;  // of 50 ms
  for (int k = 0; ::flock(fd, (shared ? LOCK_SH : LOCK_EX) | LOCK_NB) != 0; ++k) {
    const bool busy = errno == EWOULDBLOCK || errno == EINTR;
    if (busy && k < kTries) {
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
      continue;
    }
    const auto error = last_error();
    ::close(fd);
    if (!busy) return cannot_write(path, error);
    return Error{.code = "output-busy",
                 .message = "another batch is writing into this folder",
                 .file = path.parent_path().parent_path().string(),
                 .hint = "wait for it, or choose another output folder"};
  }
  return fd;
}

Result<void> sync_folder(const fs::path& folder) {
  const int fd = ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return cannot_write(folder, last_error());
  const bool ok = ::fsync(fd) == 0;
  const auto error = last_error();
  ::close(fd);
  if (!ok) return cannot_write(folder, error);
  return {};
}

std::string shard_name(const Shard& shard) {
  return shard.whole() ? "" : fmt::format("{}-of-{}.", shard.number, shard.count);
}

}  // namespace

OutputTree::~OutputTree() {
  if (shard_lock_ >= 0) ::close(shard_lock_);
  if (lock_ >= 0) ::close(lock_);
}

OutputTree::OutputTree(OutputTree&& other) noexcept
    : output_(std::move(other.output_)),
      own_(std::move(other.own_)),
      run_(std::move(other.run_)),
      shard_(other.shard_),
      lock_(std::exchange(other.lock_, -1)),
      shard_lock_(std::exchange(other.shard_lock_, -1)),
      staged_(other.staged_),
      journal_(std::move(other.journal_)),
      touched_(std::move(other.touched_)) {}

Result<OutputTree> OutputTree::open(const fs::path& output, const Shard& shard) {
  OutputTree tree;
  tree.output_ = output;
  tree.own_ = output / ".limber";
  tree.shard_ = shard;
  std::error_code error;
  fs::create_directories(tree.own_ / "work", error);
  if (error) return cannot_write(output, error);
  const auto lock = lock_file(tree.own_ / "lock", !shard.whole());
  if (!lock) return lock.error();
  tree.lock_ = *lock;
  if (!shard.whole()) {
    const auto own_lock = lock_file(tree.own_ / (shard_name(shard) + "lock"), false);
    if (!own_lock) return own_lock.error();
    tree.shard_lock_ = *own_lock;
  }
  auto journal = Journal::open(tree.own_ / (shard_name(shard) + "records.jsonl"));
  if (!journal) return journal.error();
  tree.journal_ = std::move(*journal);
  if (auto r = sync_folder(tree.own_); !r) return r.error();
  // No two runs may take one name for different items: the number is in no output.
  std::random_device random;
  tree.run_ = fmt::format("{}{:08x}{:08x}", shard_name(shard), random(), random());
  return tree;
}

Result<void> OutputTree::look_back(const std::function<void(BatchRecord)>& take) {
  std::vector<fs::path> journals;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(own_, ignored)) {
    if (entry.path().filename().string().ends_with("records.jsonl")) journals.push_back(entry);
  }
  std::sort(journals.begin(), journals.end());
  const std::string own = shard_name(shard_);
  Result<void> moved;
  for (const fs::path& journal : journals) {
    read_journal(journal, [&](BatchRecord record) {
      const bool ours = shard_.whole() || record.staged.starts_with(own);
      if (moved && ours) moved = move_into_place(record);
      take(std::move(record));
    });
  }
  if (!moved) return moved;
  for (const auto& entry : fs::directory_iterator(own_ / "work", ignored)) {
    if (entry.path().filename().string().starts_with(own)) fs::remove_all(entry.path(), ignored);
  }
  return {};
}

bool OutputTree::holds(const BatchRecord& record, bool rehash) const {
  return std::all_of(record.files.begin(), record.files.end(), [&](const FileStamp& file) {
    struct stat info {};
    const fs::path path = output_ / file.path;
    if (::stat(path.c_str(), &info) != 0 || info.st_size != file.bytes) return false;
    if (!rehash) return true;
    const auto hash = hash_file(path);
    return hash.ok() && *hash == file.hash;
  });
}

Result<fs::path> OutputTree::stage() {
  const fs::path staged = own_ / "work" / fmt::format("{}-{}", run_, ++staged_);
  if (::mkdir(staged.c_str(), 0777) != 0) return cannot_write(staged, last_error());
  return staged;
}

void OutputTree::discard(const fs::path& staged) {
  std::error_code ignored;
  fs::remove_all(staged, ignored);
}

Result<void> OutputTree::commit(BatchRecord record, const fs::path& staged) {
  record.staged = staged.filename().string();
  if (auto r = journal_.append(record); !r) return r;
  return move_into_place(record);
}

/// Does nothing where it has been done.
Result<void> OutputTree::move_into_place(const BatchRecord& record) {
  const fs::path staged = own_ / "work" / fs::path(record.staged).filename();
  struct stat info {};
  if (record.staged.empty() || ::lstat(staged.c_str(), &info) != 0) return {};
  std::error_code error;
  for (const FileStamp& file : record.files) {
    const fs::path place = output_ / file.path;
    const fs::path folder = place.parent_path();
    if (touched_.insert(folder).second) fs::create_directories(folder, error);
    if (error) return cannot_write(folder, error);
    const bool moved = ::rename((staged / place.filename()).c_str(), place.c_str()) == 0;
    if (!moved && errno != ENOENT) return cannot_write(place, last_error());
  }
  for (const std::string& old : record.removes) fs::remove(output_ / old, error);
  fs::remove_all(staged, error);
  return {};
}

Result<void> OutputTree::sync() {
  for (const fs::path& folder : touched_) {
    if (auto r = sync_folder(folder); !r) return r;
  }
  touched_.clear();
  return sync_folder(output_);
}

}  // namespace limber
