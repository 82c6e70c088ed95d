"""Training of passage networks."""

import glob, io, json, math, os, sys, time
from pathlib import Path
import numpy as np
import torch
from torch import nn
from torch.nn import functional
from nnpp_edge.model.passage import PassageNet
from nnpp_edge.runtime.network.passage import shown_blocks, shown_numbers, vehicle_numbers
from nnpp_edge.terrain.passage import of_stored, unpacked_heights

# heading after a flip of rows, and after a transposition
FLIPPED, TRANSPOSED = (0, 3, 2, 1), (2, 1, 0, 3)

class Maps:
    def __init__(self, folder, most=10**9):
        self.folder, self.files, self.most = Path(folder), [], most
        self.h, self.s, self.v, self.p, self.c = [], [], [], [], []
        self.reload()
    def reload(self):
        for f in sorted(self.folder.glob('shard-?????.npz')):
            if f in self.files or len(self.files) >= self.most: continue
            self.files.append(f)
            with np.load(f) as a:
                g = len(a['heights']) // len(a['vehicle'])
                for k in range(len(a['vehicle'])):
                    part = slice(k*g, (k+1)*g)
                    self.h.append(a['heights'][part]) if k else self.h.append(a['heights'][part])
                    self.s.append(a['scale'][part]); self.v.append(a['vehicle'][k])
                    self.p.append(a['passing'][part]); self.c.append(a['cost'][part])
        return len(self.v)
    def batch(self, which, rng):
        xs, ps, cs, ns = [], [], [], []
        for k in which:
            vehicle = of_stored(self.v[k]); ns.append(shown_numbers(vehicle_numbers(vehicle, (1., 1.))))
            for h, s, p, c in zip(self.h[k], self.s[k], self.p[k], self.c[k]):
                h = unpacked_heights(h, s)
                if rng is not None:
                    t, f, l = rng.random(3) < .5
                    if f: h, p, c = h[::-1], p[FLIPPED, ::-1], c[FLIPPED, ::-1]
                    if l: h, p, c = h[:, ::-1], p[FLIPPED, :, ::-1], c[FLIPPED, :, ::-1]
                    if t: h, p, c = h.T, p.transpose(0, 2, 1)[TRANSPOSED,], c.transpose(0, 2, 1)[TRANSPOSED,]
                    h = np.ascontiguousarray(h)
                rows, cols = p.shape[1:]
                xs.append(shown_blocks(h, (1., 1.), vehicle, (-1, -1), (rows+2, cols+2))); ps.append(p); cs.append(c)
        n = len(which); form = lambda a: torch.from_numpy(np.stack(a)).reshape(n, -1, *a[0].shape)
        return form(xs), torch.from_numpy(np.stack(ns)), form(ps), form(cs)

def loss_of(out, p, c):
    share, cost = p.float()/16, c.float()/255
    out = out.float()[..., 1:-1, 1:-1]
    chance, t = out[:, :, :4], out[:, :, 4:]
    a = functional.binary_cross_entropy_with_logits(chance, share)
    b = (functional.binary_cross_entropy_with_logits(t, cost, reduction='none')*share).sum()/share.sum().clamp_min(1)
    with torch.no_grad():
        e = (torch.sigmoid(chance)-share).abs().mean(); et = ((torch.sigmoid(t)-cost).abs()*share).sum()/share.sum().clamp_min(1)
    return a + b, (a.item(), b.item(), e.item(), et.item())

def shown(x): return (x.float()-128)/127

def judge(net, maps, most=64):
    rows = []
    with torch.no_grad():
        for k in range(0, min(len(maps.v), most), 8):
            x, n, p, c = maps.batch(range(k, k+8), None)
            with torch.autocast('cpu', torch.bfloat16):
                out = net(shown(x), n)
            rows.append(loss_of(out, p, c)[1])
    return np.mean(rows, 0)

def main(data, val, out, steps, options, lr=2e-3, vehicles=16, seed=1, warm=200):
    out = Path(out); out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(seed); net = PassageNet(**options)
    ema = PassageNet(**options); ema.load_state_dict(net.state_dict())
    opt = torch.optim.AdamW(net.parameters(), lr=lr, weight_decay=1e-4)
    step, history, spent = 0, [], 0.
    path = out/'checkpoint.pt'
    if path.exists():
        s = torch.load(path, weights_only=True); net.load_state_dict(s['network']); ema.load_state_dict(s['average']); opt.load_state_dict(s['optimiser']); step, history, spent = s['step'], s['history'], s['spent']
    maps, check = Maps(data), Maps(val, 4)
    rows, t0 = [], time.monotonic()-spent
    while step < steps:
        rng = np.random.default_rng([seed, step])
        if step % 500 == 0: maps.reload()
        x, n, p, c = maps.batch(rng.choice(len(maps.v), vehicles, replace=False), rng)
        rate = lr*min(1, (step+1)/warm)*(0.01+0.99*0.5*(1+math.cos(math.pi*min(1, step/steps))))
        for g in opt.param_groups: g['lr'] = rate
        with torch.autocast('cpu', torch.bfloat16):
            o = net(shown(x), n)
        loss, row = loss_of(o, p, c)
        opt.zero_grad(set_to_none=True); loss.backward(); nn.utils.clip_grad_norm_(net.parameters(), 1.); opt.step()
        step += 1; rows.append(row)
        d = min(.998, (1+step)/(10+step))
        with torch.no_grad(): torch._foreach_lerp_(list(ema.parameters()), list(net.parameters()), 1-d)
        if step % 250 == 0 or step == steps:
            spent = time.monotonic()-t0
            j = judge(ema, check); history.append([step, spent, *np.mean(rows, 0).tolist(), *j.tolist()]); rows = []
            print(step, round(spent), 'maps', 4*len(maps.v), 'train', np.round(history[-1][2:6], 4), 'val', np.round(j, 4), flush=True)
            tmp = path.with_suffix('.tmp')
            torch.save({'options': options, 'network': net.state_dict(), 'average': ema.state_dict(), 'optimiser': opt.state_dict(), 'step': step, 'history': history, 'spent': spent}, tmp); os.replace(tmp, path)

if __name__ == '__main__':
    torch.set_num_threads(1)
    a = json.loads(sys.argv[1]); main(**a)
