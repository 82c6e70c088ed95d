// A client of `nnpp-edge run` without libraries: JSON lines over pipes to a child process.
// g++ -std=c++17 -o client client.cpp && ./client 5 5 60 70 nnpp-edge run --map dem.tif --rate 100
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

using Clock = std::chrono::steady_clock;  // in nanoseconds
using Path = std::vector<std::pair<int, int>>;  // rows and columns

static double now_ms() { return 1e-6 * Clock::now().time_since_epoch().count(); }

// Waits for a path that was checked on so many patches; empty once the loop has ended.
static Path next_path(FILE* answers, int patches) {
    static char* line;
    static size_t room;
    Path path;
    while (path.empty() && getline(&line, &room, answers) > 0) {
        const char* version = strstr(line, "\"map_version\":");
        const char* at = strstr(line, "\"path\":[[");  // without a path "reason" says why
        if (!at || !version || atoi(version + 14) < patches) continue;
        int row, col, length;
        for (at += 8; sscanf(at, "[%d,%d]%n", &row, &col, &length) == 2; at += length + 1)
            path.push_back({row, col});
    }
    return path;
}

int main(int count, char** words) {  // row and column of robot and goal, then the loop's command
    int in[2], out[2];
    if (count < 6 || pipe(in) || pipe(out)) return 2;
    if (fork() == 0) {
        dup2(in[0], 0), dup2(out[1], 1);
        for (int end : {in[0], in[1], out[0], out[1]}) close(end);
        execvp(words[5], words + 5);
        _exit(127);
    }
    close(in[0]), close(out[1]);
    FILE *inputs = fdopen(in[1], "w"), *answers = fdopen(out[0], "r");
    const char* pose = "{\"type\":\"pose\",\"row\":%d,\"col\":%d}\n";
    const char* patch = "{\"type\":\"patch\",\"row\":%d,\"col\":%d,\"cost\":[[0.3]]}\n";
    fprintf(inputs, "{\"type\":\"goal\",\"row\":%s,\"col\":%s}\n", words[3], words[4]);
    fprintf(inputs, pose, atoi(words[1]), atoi(words[2]));
    Path path;
    for (int patches = 0; patches == 0 || path.size() > 3; patches++) {
        fflush(inputs);
        double began = now_ms();
        path = next_path(answers, patches);
        printf("%zu cells after %.1f ms\n", path.size(), now_ms() - began);
        if (path.size() > 3) fprintf(inputs, pose, path[1].first, path[1].second);
        if (path.size() > 3) fprintf(inputs, patch, path[3].first, path[3].second);
    }
    fclose(inputs);  // ends the loop, which answers what it has taken
    next_path(answers, 1 << 30);
    return path.empty();
}
